"""Goals of the benchmarks: what falls short of one is listed as missed, and `bcid bench --check` ends with code 5."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SpeedGoals:
    """Lowest ratios of a peer's time to ours, and longest times; docs/results/bench.json shows what is reached."""

    # A Newton-Euler rollout against C written by hand.
    c_rollout: float = 1.0
    # The same rollout against C that casadi generates.
    casadi_c_rollout: float = 1.0
    # The same rollout against casadi's virtual machine.
    casadi_rollout: float = 3.0
    # The same rollout against JAX.
    jax_rollout: float = 5.0
    # The same rollout against a loop in numpy.
    numpy_rollout: float = 100.0
    # A step (us) of a Newton-Euler car as exported C, on the machine of the committed figures.
    exported_us: float = 1.0
    # The same of the car with what the sample's diagnosis finds (us).
    exported_augmented_us: float = 4.0
    # Of both, against the C that casadi generates of the same formulas.
    exported_ratio: float = 1.0
    # A step (us) of exported C with a perceptron.
    exported_network_us: float = 2.0
    # The same against casadi's C, whose products are plain loops in double precision.
    exported_network_ratio: float = 5.0
    # A thousand Newton-Euler rollouts against C that advances cars abreast.
    c_many_rollouts: float = 1.0
    # The same thousand against numpy, one operation for all cars.
    numpy_many_rollouts: float = 10.0
    # The same thousand against torch.
    torch_many_rollouts: float = 10.0
    # The same thousand against JAX.
    jax_many_rollouts: float = 10.0
    # The same thousand in single precision against our double precision.
    single_over_double: float = 2.0
    # The same thousand in single precision against C in single precision.
    c_many_single_rollouts: float = 1.0
    # A K-MLP rollout with hidden layers of 256 and 128 units against torch.
    torch_network_256: float = 30.0
    # A K-MLP rollout with hidden layers of 128 and 64 units against torch.
    torch_network_128: float = 80.0
    # A K-MLP rollout of either size against onnxruntime, called once a period.
    onnxruntime_network: float = 5.0
    # A K-MLP rollout of either size against onnxruntime with the whole rollout in its graph.
    onnxruntime_scan: float = 3.0
    # A K-SINDy rollout against a loop over its coefficients in numpy.
    numpy_sindy: float = 30.0
    # A K-SINDy rollout against pysindy's.
    pysindy_rollout: float = 10_000.0
    # Longest time (ms) of a K-SINDy rollout.
    longest_sindy_ms: float = 0.06
    # The EKF's forward pass against C written by hand.
    c_filter: float = 1.0
    # The EKF's forward pass against filterpy's.
    filterpy_filter: float = 50.0
    # Longest time (us) of an event of the EKF.
    longest_event_us: float = 0.5
    # The smoother against filterpy's.
    filterpy_smoother: float = 20.0
    # A training epoch against torch's DataLoader.
    data_loader_epoch: float = 1.5
    # A Newton-Euler fit against deap's genetic algorithm.
    deap_fit: float = 30.0
    # A descent to a car's constants against scipy's least squares on the same residuals.
    scipy_fit: float = 1.0
    # Slowest reading (MB/s) of a Motive export, all of it verified.
    slowest_motive_mb_s: float = 120.0
    # Longest time (us) of a message of an MCAP file, all of it verified.
    longest_message_us: float = 4.0
    # Largest difference (SI) of results that should be the same.
    max_difference: float = 1e-9
    # Largest difference of the NMSE that two descents end at.
    max_nmse_difference: float = 1e-7
    # Largest share by which least squares may end at a higher NMSE than the genetic algorithm.
    max_nmse_excess: float = 0.0


@dataclass(frozen=True)
class AccuracyGoals:
    """Goals of the comparison of models; docs/results/accuracy.json shows what is reached."""

    # Largest difference between seeds, as a share of the median NMSE through a whole take.
    max_seed_change: float = 0.1
    # NMSE through a whole take after the simulated hour, which the models in `accuracy.SMALLEST` must stay below.
    max_hour_nmse: float = 5e-3


@dataclass(frozen=True)
class RecoveryGoals:
    """Goals of fits to simulated cars; docs/results/parameters.json shows what is reached."""

    # Share of constants that must lie in the 95 % intervals of a fit to poses.
    coverage: tuple[float, float] = (0.90, 0.98)


@dataclass(frozen=True)
class FleetGoals:
    """What a log may cost in a large fleet, beside a small one."""

    # CPU time of a log in a fleet of sixteen times as many, over that in the small one.
    most_growth: float = 1.1
    # Growth of the largest memory of any process: a log is to leave nothing behind.
    most_memory_growth: float = 0.1


SPEED, ACCURACY, RECOVERY, FLEETS = SpeedGoals(), AccuracyGoals(), RecoveryGoals(), FleetGoals()
