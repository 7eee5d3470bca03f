"""The paper's chain against the estimators that replace it: docs/identification.md."""
