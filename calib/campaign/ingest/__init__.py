"""From a laboratory's files and recordings to a campaign: describe them, map their columns, cut them into runs."""

from calib.campaign.ingest.build import Ingested, ingest, merged_notes, write_blank
from calib.campaign.ingest.describe import Description, describe

__all__ = ["Description", "Ingested", "describe", "ingest", "merged_notes", "write_blank"]
