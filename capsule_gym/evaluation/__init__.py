"""Evaluation of policies: evaluation sets, episodes, statistics, and the optimum of dynamic
programming.
"""
