"""Track files, overlay videos and plots."""
