"""Evaluation: data sets, protocols, measures, the benchmark, its tables and figures."""
