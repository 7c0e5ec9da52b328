"""What the site has beside the pages: references from code, its examination."""
