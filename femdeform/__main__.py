"""``python -m femdeform``."""

import sys

from femdeform.cli import main

if __name__ == "__main__":
    sys.exit(main())
