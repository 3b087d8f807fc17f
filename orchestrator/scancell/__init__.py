"""Simulated robot cell that scans parts in 3D with a laser profile sensor.

>>> import scancell
>>> with scancell.Scanner() as scanner:
...     result = scanner.scan("part.stl", engine="geometric")

All that is public is here, under one name: ``scancell.NAME``. Modules are private. The names are listed in
``__init__.pyi``; the object behind a name is imported when it is first used, so that ``import scancell`` stays fast.
"""

from importlib.metadata import version

import lazy_loader

__version__ = version("scancell")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
