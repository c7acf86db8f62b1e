"""The environment in a browser: the core as WebAssembly, its data, and the live page."""
