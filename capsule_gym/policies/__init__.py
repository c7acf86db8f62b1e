"""Policies: trained ones and their files, scripted ones, and whole episodes inside the core."""
