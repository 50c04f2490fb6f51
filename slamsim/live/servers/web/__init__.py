"""What the page of a live robot is made of: its assets, what it shows, what it may ask for."""
