"""Learned agents: training, evaluation, the leaderboard. Lives in the checkout and is not
installed.
"""
