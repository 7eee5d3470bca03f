"""The virtual towing tank against bodies whose added mass and drag are known, and docs/tank.md."""
