"""``calib challenge``: a blind check of the diagnosis on cases whose truth is sealed."""
