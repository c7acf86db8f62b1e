"""The compiled core, `_core`, with its C++ sources; access to its functions and its arrays from Python."""
