"""What the site has beside the pages: navigation, references from code."""
