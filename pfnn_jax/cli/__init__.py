"""The command `pfnn-jax`: parsing, and one function call for each sub-command."""

from pfnn_jax.cli.main import main as main
