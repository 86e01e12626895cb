"""From a laboratory's files and recordings to a campaign: describe them, map their columns, cut them into runs."""
