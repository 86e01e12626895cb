"""What was driven and measured, as arrays over runs and samples."""
