"""What long work needs of the machine: files, threads, a cluster, signals and the display of progress."""
