"""Independent programs that check us: POV-Ray, Mitsuba, Open3D, EAIK. None of them is a requirement."""
