"""One view a result: its headings, tables and sentences, as text and in a page."""
