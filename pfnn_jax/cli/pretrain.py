"""`pfnn-jax pretrain`: from a dataset to a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import FLAT, Command
from pfnn_jax.cli.several_hosts import HostsConfig, run_in_child
from pfnn_jax.training.config import PretrainConfig


@dataclass(frozen=True, kw_only=True)
class Pretrain(Command):
    """Train a network on a dataset, with one set of shared parameters and an adapter for each style.

    Minibatches are split over all devices that JAX finds; a run may be resumed on another number of them. With
    --coordinator they are the devices of several hosts, on each of which the same command is started.

    Attributes:
        dataset: folder that `prepare` has written.
        out: folder of the run.
        resume: continue an interrupted run with the same settings, or train a finished one for more steps.
        overwrite: replace an existing run.
        hosts: where several train.
        config: how to train.
    """

    dataset: Annotated[Positional[Path], tyro.conf.arg(metavar="DATASET")]
    out: Path
    resume: bool = False
    overwrite: bool = False
    hosts: Annotated[HostsConfig, FLAT] = HostsConfig()
    config: Annotated[PretrainConfig, FLAT] = field(default_factory=PretrainConfig)

    def run(self) -> Any:
        return self._train() if self.hosts.coordinator is None else run_in_child(self._train, self.hosts)

    def _train(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.motion.datasets.dataset import load_dataset
        from pfnn_jax.run_config import check_new_run

        is_first = self.hosts.is_first()
        if is_first and not self.resume:
            check_new_run(self.out, self.overwrite)
        dataset = load_dataset(self.dataset)
        from pfnn_jax.training.sharding import describe_devices
        from pfnn_jax.workflows.pretrain import join_pretraining, pretrain_run

        devices = describe_devices(self.config.batch_size)
        if not is_first:
            return join_pretraining(dataset, self.config)
        if devices is not None:
            print(devices)
        with progress("training") as report:
            run = pretrain_run(
                dataset,
                self.out,
                self.config,
                resume=self.resume,
                overwrite=self.overwrite,
                progress_callback=lambda now: report(
                    now.step, now.steps, f"loss {now.loss:.4f}, {now.frames_per_second:,.0f} frames/s"
                ),
            )
        print(f"{run.path}: styles {', '.join(run.config.styles)}")
        return {"run": run.path, "styles": run.config.styles}
