"""The radius law as the vehicle gets it: the coefficient file and its views."""
