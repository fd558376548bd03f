"""Tables of figures: one model, and its renderers for the terminal, HTML, Markdown and CSV."""
