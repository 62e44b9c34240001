"""Stylised character locomotion from short clips.

The public names live in six namespaces: `motion`, `models`, `training`, `control`, `workflows` and `viewer`. Each is
imported when it is first used, so that reading motion does not wait for JAX. The `.pyi` file next to a namespace lists
its names, for Python as well as for editors and type checkers.
"""

import lazy_loader

__version__ = "0.1.0"

_ROOMS = {
    "errors": ("InputError", "TrainingError"),
    "motion.bvh": ("read_bvh", "write_bvh"),
    "motion.clip": ("MotionClip",),
    "motion.datasets.dataset": ("Dataset", "load_dataset", "prepare"),
    "motion.datasets.download": ("download_100style",),
    "motion.features.encode": ("clip_features",),
    "motion.hands": ("extend_hands",),
    "motion.datasets.labelled": ("LabelledClip", "load_labelled"),
    "motion.features.layout": (
        "FrameLayout",
        "layout_for",
        "mason2018",
        "mason2022",
        "mason2022_mann",
        "mason2022_pfnn",
        "pfnn2017",
    ),
    "motion.labels.local_phase": (
        "LocalPhaseConfig",
        "clip_local_phases",
        "fit_axes",
        "mirror_local_phases",
        "toe_contacts",
    ),
    "motion.labels.phase": ("label_phase", "read_phase", "write_phase"),
    "motion.datasets.preparation": ("PrepareConfig",),
    "motion.datasets.sources": ("ClipFile", "list_clips"),
    "motion.datasets.takes": ("load_take", "take_features"),
    "motion.synthetic.walks": ("synthesise", "synthetic_clips"),
    "models.adapters": ("AdapterConfig", "OneHot", "init_style"),
    "models.film": ("FiLMStyle", "identity_film", "layer_norm", "layer_norm_sample", "mix", "modulate"),
    "models.film_generator": ("FiLMGenerator", "GeneratorConfig", "film_generator"),
    "models.gating": ("Gating", "gate", "init_gating"),
    "models.layers": ("BiasLayer", "BlendedLayer", "CPLayer", "DenseLayer", "DiagonalLayer", "linear"),
    "models.network": ("Network", "NetworkConfig", "coefficients", "forward", "init_network", "predict"),
    "models.presets": ("TABLE2", "network_config"),
    "models.spline": ("catmull_rom_basis", "evaluate_spline"),
    "training.few_shot": ("FILM_FEW_SHOT", "MASON2018_FEW_SHOT", "FewShotConfig", "train_bank", "train_grid"),
    "workflows.pretrain": ("pretrain_run",),
    "training.config": ("PretrainConfig",),
    "training.tuning": ("TuningConfig", "tune_generator"),
    "run": ("Run", "list_styles", "load_generator", "load_run", "load_style", "save_style"),
    "training.data": ("dataset_rows",),
    "interop.export.run": ("export_run",),
    "control.controller": ("Controller", "drive", "make_controller"),
    "control.ik.fix_feet": ("fix_feet",),
    "control.loop.step": ("Command",),
    "control.ik.foot_lock": ("FootLockConfig", "initial_locks", "lock_feet"),
    "control.drive_along": ("drive_along",),
    "control.generate": ("generate",),
    "workflows.learn": ("learn_style", "tune_style"),
    "control.ik.limb": ("reach_arms", "two_bone"),
    "inference.lookup": ("evaluate_lookup", "make_lookup"),
    "motion.paths": ("circle", "figure_eight", "read_path", "straight"),
    "control.ik.pose": ("Pose", "Rig", "make_rig", "pose_from_world"),
    "inference.predictor": ("evaluate", "make_predictor"),
    "interop.released.holden2017": ("import_released_pfnn",),
    "interop.released.mason2018": ("import_released_cp",),
    "interop.released.mason2022": ("import_released_lpn",),
    "control.loop.rollout": ("follow_path", "rollout"),
    "viewer.draw.filmstrip": ("filmstrip",),
    "viewer.player.notebook": ("show",),
}
_ROOM_OF = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _ROOM_OF:
        raise AttributeError(f"module 'pfnn_jax' has no public name {name!r}")
    return getattr(import_module(f"pfnn_jax.{_ROOM_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_ROOM_OF)
