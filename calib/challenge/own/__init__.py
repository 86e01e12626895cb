"""Known effects planted on a campaign's own noise and route: what this lab's data would find."""
