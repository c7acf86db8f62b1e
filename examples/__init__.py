"""One short program for each library that the page "Works with" names; every one runs by itself."""
