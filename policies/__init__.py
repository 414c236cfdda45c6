"""Our ONNX skills with a manifest each, and the generator that builds them."""
