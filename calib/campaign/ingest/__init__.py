"""A laboratory's files and recordings become a campaign: described, mapped, cut into runs."""
