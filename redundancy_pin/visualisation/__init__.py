"""Pictures: loci, paths, efforts. Matplotlib, which takes long, is imported when a picture is drawn."""
