"""Pages, tables and exported files of suites.

page.py            the page and the files of a suite: suite.json, report.html, pages of single results
  tables.py        tables of a suite, of a comparison of suites, and of the required numbers of drives
  export.py        JUnit XML, MLflow and Parquet
search_page.py     tables and page of a search for the worst case
history_page.py    table and page of a history
"""
