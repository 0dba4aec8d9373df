"""What is made of recordings: tables, pictures, pages."""
