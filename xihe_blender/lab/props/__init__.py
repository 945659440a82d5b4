"""Building blocks of rooms: solids, materials, furniture, lamps, walls; shared by the scenes and the data set."""
