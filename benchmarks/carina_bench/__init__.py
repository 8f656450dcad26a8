"""``carina bench``: Carina beside its peers, in one run on one machine (extra ``bench``).

A figure is a ratio of CPU times that were taken in turn in one process with one thread; the milliseconds of a shared
machine mean little. Each section runs in a process of its own, because the number of threads is fixed when the first
picture is cast.
"""
