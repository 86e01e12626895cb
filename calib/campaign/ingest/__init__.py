"""From a laboratory's files and recordings to a campaign: describe what is there, map it, cut it into runs."""

from calib.campaign.ingest.describe import Description, describe
from calib.campaign.ingest.gathered import gathered
from calib.campaign.ingest.run import Ingested, ingest

__all__ = ["Description", "Ingested", "describe", "gathered", "ingest"]
