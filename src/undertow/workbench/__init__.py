"""A local page on which a model is looked at beside logs, mended, and written out."""
