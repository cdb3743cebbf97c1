"""Contact with rigid obstacles, of bodies with one another and with themselves."""
