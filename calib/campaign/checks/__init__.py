"""Checks of a campaign, by topic; `calib.campaign.check` runs them."""
