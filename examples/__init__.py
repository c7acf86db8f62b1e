"""One short program for each library that the page "Works with" names; every program runs on its
own.
"""
