"""`python -m pfnn_jax.cli`."""

from pfnn_jax.cli.main import main

main()
