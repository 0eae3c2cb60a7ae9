"""The dashboard: a page in the browser to watch controllers and drives, and to act on them."""
