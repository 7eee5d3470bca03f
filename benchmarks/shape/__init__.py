"""Added mass of simple bodies by panels: the table that `undertow` ships for boxes, and docs/shape.md."""
