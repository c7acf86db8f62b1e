"""The text of the paper's reproduction."""
