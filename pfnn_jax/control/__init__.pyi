from .controller import Controller as Controller
from .controller import make_controller as make_controller
from .generation import generate as generate
from .ik.fix_feet import fix_feet as fix_feet
from .loop.step import Command as Command
