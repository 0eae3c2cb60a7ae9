"""The law with one encoder alone: a model of both shafts gives what is not measured, and the plans are the same."""
