"""From a laboratory's files and recordings to a campaign: describe what is there, map it, cut it into runs."""

from calib.campaign.ingest.run import Ingested, ingest

__all__ = ["Ingested", "ingest"]
