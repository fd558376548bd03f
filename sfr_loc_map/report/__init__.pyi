from .page import render_page as render_page
from .page import write_page as write_page
from .score_tables import score_markdown as score_markdown
