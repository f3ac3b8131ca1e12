"""Reports that compare the cells of an experiment: numbers, findings, figures and pages."""
