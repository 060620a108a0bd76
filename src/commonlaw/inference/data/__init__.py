"""What is known before any law: noise, smooth curves, some of many samples."""
