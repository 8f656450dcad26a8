"""``carina bench``: benchmarks of Carina and of the programs with which it is compared (extra ``bench``).

A figure is a ratio of two CPU times that were measured alternately, on one machine, in one process with one thread;
absolute times of a shared machine are unreliable. Each section of a benchmark runs in a separate process, because the
number of threads is fixed when the first picture is cast.
"""
