"""What a result says, built once as blocks, for the terminal, the PDF and the HTML page alike."""
