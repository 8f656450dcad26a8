"""Values that the session computes from the case: walls, measurements, plans and lungs."""
