"""Learned parts: one network a module, and the weights that are shipped; nothing here knows a sensor."""
