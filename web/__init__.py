"""The environment in a browser: the compiled step as WebAssembly, its data, and the page around
it.
"""
