"""Evaluation: data sets, protocols, metrics, the benchmark, its tables and figures."""
