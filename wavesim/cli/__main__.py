"""`python -m wavesim.cli`."""

from wavesim.cli.commands import main

main()
