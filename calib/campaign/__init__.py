"""What was driven and measured: the campaign folder, its settings, run table and logs."""
