"""What becomes of estimates: tables, overlay videos, plots, moving heads, and the summary of many videos."""
