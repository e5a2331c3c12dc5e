"""`python -m wavesim.cli`."""

from wavesim.cli import main

main()
