from .page import load_score as load_score
from .page import render_page as render_page
from .page import render_tables as render_tables
from .page import write_page as write_page
from .score_tables import score_markdown as score_markdown
