"""The errors a user can cause, each a single line that says what to change."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Bad input: names the file, the place in it, the value found and the rule it breaks."""

    def __init__(self, file: str | Path, place: str, value: object, rule: str):
        self.file, self.place, self.value, self.rule = str(file), place, value, rule
        super().__init__(f"{file}: {place}: {value}; {rule}")


class TrainingError(RuntimeError):
    """Training became non-finite: names the step, the style and the value. The last good save is kept."""

    def __init__(self, step: int, style: str, value: float):
        self.step, self.style, self.value = step, style, value
        super().__init__(
            f"training: step {step}, style {style}: loss is {value}; losses must stay finite, "
            "the last good save is kept, try a lower learning rate"
        )
