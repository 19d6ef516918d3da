"""Neural networks, one per module, and their weights. Independent of any sensor."""
