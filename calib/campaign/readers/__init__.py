"""Readers of log and table files, one file a format, chosen by suffix."""
