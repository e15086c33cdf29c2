"""`python3 -m elevator_rectify PROGRAM`: the package's programs where there is no ros2 command."""

import sys

from elevator_rectify.programs import main

if __name__ == "__main__":
    sys.exit(main())
