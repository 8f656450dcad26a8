"""``carina bench``: benchmarks of Carina and its peers, in one run on one machine (extra ``bench``).

A figure is a ratio of CPU times that were measured alternately in one process with one thread; absolute times of a
shared machine are unreliable. Each section runs in a process of its own, because the number of threads is fixed when
the first picture is cast.
"""
