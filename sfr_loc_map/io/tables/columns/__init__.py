"""The columns of a table of poses: stated by the user, by a header or by a layout, then complete with their units."""
