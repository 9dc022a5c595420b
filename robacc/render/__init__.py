"""Results as text, HTML pages and charts; nothing here computes a figure."""
