"""Policies: trained ones and their files, scripted ones, and whole episodes of a policy inside the
core.
"""
