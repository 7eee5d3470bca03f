"""Native vehicle formats: one module with a `FORMAT` each; `fieldlog` discovers them."""
