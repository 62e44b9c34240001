from .body.grow import grow_body as grow_body
from .draw.filmstrip import filmstrip as filmstrip
from .player.notebook import show as show
from .rendering import render as render
