"""The text of a table as numbers: numbers and stamps in cells, decimal commas, and the rows of a table."""
