"""What was driven and measured, as the diagnosis sees it: observations as arrays."""
