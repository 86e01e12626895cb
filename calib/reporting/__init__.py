"""What a customer gets: content, figures and the typeset page."""
