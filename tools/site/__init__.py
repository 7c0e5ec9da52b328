"""What the site has beside the pages: references from code, links into the glossary, its examination."""
