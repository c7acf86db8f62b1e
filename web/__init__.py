"""The live page: the agent step as WebAssembly, and a page that shows it at work."""
