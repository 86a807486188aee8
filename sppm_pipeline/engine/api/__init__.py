"""The program as Python sees it: stages as functions, pipelines as values, runs in memory."""
