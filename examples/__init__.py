"""One short program for each library of the page "Works with"; every program runs on its own."""
