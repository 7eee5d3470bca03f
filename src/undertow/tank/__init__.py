"""A towing tank of computed water: OpenFOAM cases around a hull, their runs, and the coefficients in them."""
