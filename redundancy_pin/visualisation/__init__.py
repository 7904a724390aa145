"""Pictures: loci, paths, efforts. Matplotlib is optional and imported when a picture is drawn."""
