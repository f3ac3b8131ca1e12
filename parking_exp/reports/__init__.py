"""Reports that compare the cells of an experiment.

The command: `report_request` checks its config, `make_report` reads results and writes the report.

Numbers: `report_builder` makes a `report_data.ReportData`, by `cell_selection` (labels, patterns,
contrasts), `cell_summaries`, `cell_comparisons`, `reported_metrics`, `provenance`, `run_checks`.

Sentences: `findings`, `report_warnings`. `formats` turns numbers into text.

Sections: `sections` lists them, with the functions of `figures/` and `tables/`. `search_report` has
the sections of a search, and tasks have their own.

Files: `report_files` writes them all. `report_page` makes the page.
"""
