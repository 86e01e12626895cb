"""An independent vehicle that makes campaigns; it imports nothing of ``motion`` or ``gap``."""
