"""What a trained model is turned into: evaluation, pictures, meshes, films, reports."""
