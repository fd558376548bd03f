"""Tables, plots, pages and reports of a score. Nothing in this package changes a score.

A *figure* is a row of the table of figures of a score, a *plot* is a drawing. The parts of a score are shown as
follows:

- figures: `score_tables` selects the rows of each table (`VIEWS`). The package `tables` has the model of a table, and
  writes tables for the terminal and as HTML, Markdown and CSV.
- verdicts: `verdict_view` composes the displayed texts of a verdict for the table of verdicts, the results of the test
  report, `junit` and `control_document`.
- details: `plotted_data` selects the plotted data. `page` composes the plots of a page (`drive_plots`, `call_plots`,
  `map_plots`, in the terms of `plots`), and `printed_plot` makes those of the test report. `limit_lines` draws limits.
- records: `summary` makes the banner, the header and the first items to look at, `notes` the notes of tables, and
  `deviations` the deviations from the specification. `settings` finds the settings that differ from their defaults.

`page` (`Page`) and `test_report` (`ReportToSign`) compose these parts in the order of their templates. Several scores
of the same data are shown by `comparison` and `methods_page`. `diagnosis_table` and `path_plot` do not show a score.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
