"""Movement of a target between two CTs of one patient, measured from forks of the airways and from vessels."""
