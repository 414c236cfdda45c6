"""Four pieces of music composed and synthesised by our own code; `store` builds and caches them."""
