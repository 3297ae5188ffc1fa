"""Examples at the end of each help: what is typed, and what it does; a test holds them to the command line."""

EXAMPLES: dict[str, dict[str, str]] = {
    "init": {
        "bcid init": "writes vehicle.toml and pipeline.toml into this folder",
        "bcid init my-lab": "into the folder my-lab",
    },
    "ingest": {
        "bcid ingest": "reads the takes of the pipeline.toml of this folder",
        "bcid ingest --check": "says go or no-go of each take, and writes nothing",
        "bcid ingest take.csv --table take.parquet": "writes poses and commands as they were read, in SI units",
        "bcid ingest 'take.csv[12:40]'": "reads the seconds 12 to 40 only",
    },
    "estimate": {
        "bcid estimate": "velocities and slip angles of all takes of the pipeline.toml of this folder",
        "bcid estimate take.csv --vehicle vehicle.toml --out work": "of one take, without a pipeline file",
    },
    "fit": {
        "bcid fit": "fits the models of the pipeline.toml of this folder, and scores them",
        "bcid fit --model newton-euler --model k-sindy": "these two",
        "bcid fit --model newton-euler --loss poses": "a car's constants, from the poses themselves",
        "bcid fit --model k-sindy --equations": "prints its equations, too",
    },
    "report": {
        "bcid report": "compares the models that are fitted",
        "bcid report --model newton-euler --model diagnosis": "one model, and the car with what a diagnosis found",
    },
    "run": {
        "bcid run": "everything in the pipeline.toml of this folder",
        "bcid run -p my-lab/pipeline.toml": "everything in another one",
    },
    "diagnose": {
        "bcid diagnose": "what the takes show that newton-euler lacks",
        "bcid diagnose 'take.csv[0:120]'": "what the first two minutes of one take show",
        "bcid diagnose take.csv --simulation sim.mcap": "what another simulator lacks, by its log of the same car",
    },
    "compare": {
        "bcid compare last_week/workspace workspace": "is it the same car as last week?",
        "bcid compare newton-euler newton-euler-poses": "two saved models, by their names",
    },
    "fleet": {
        "bcid fleet logs --vehicle vehicle.toml --out work": "everything, of each log in the folder logs by itself",
        "bcid fleet monday tuesday --jobs 4 --no-diagnose": "of two folders, four logs at a time, without diagnoses",
        "bcid fleet logs --labels fleet.csv": "days and cars by a table with the columns log, day and car",
        "bcid fleet logs --dask tcp://desk:8786": "on the workers of a Dask cluster, which see the same files",
    },
    "pool": {
        "bcid pool": "one car, and its loads, in the training and validation takes of the pipeline.toml here",
        "bcid pool day1.csv day2.csv day3.csv --own mass --own motor": "load and battery of three drives, by that file",
    },
    "plan": {
        "bcid plan --vehicle vehicle.toml": "a drive in which all effects would show",
        "bcid plan yaw_scrub tether_pull --vehicle vehicle.toml --arena 6,4": "in which these two would, on 6 m by 4 m",
    },
    "simulate": {
        "bcid simulate": "five minutes of the simulated car, in simulated/",
        "bcid simulate drive --duration 120 --set steering_delay=0.05": "of a car that lacks something",
        "bcid simulate ahead --model diagnosis --commands plan.commands.csv": "what a saved model predicts",
    },
    "predict": {
        "bcid predict newton-euler --from take.csv --at 12.5": "from the moment 12.5 s of a take on, with covariance",
        "bcid predict diagnosis --commands plan.commands.csv --state v_x=0.8": "from a state, under other commands",
    },
    "adapt": {
        "bcid adapt newton-euler take.csv": "weighs the car while it drives, and writes the filter in C",
        "bcid adapt diagnosis take.csv --quantity grip --quantity steering_offset": "follows the grip and the trim",
    },
    "export": {
        "bcid export newton-euler": "a fitted model in every format that suits it",
        "bcid export diagnosis --format c --format casadi": "the car with what was found, as C and for CasADi",
    },
    "view": {
        "bcid view take.csv --vehicle vehicle.toml": "a take for Foxglove: poses, the car, commands",
        "bcid view workspace": "what was diagnosed: before, after, pushes, findings",
        "bcid view workspace --tables tables": "the results as CSV and LaTeX",
    },
    "models": {"bcid models": "what can be fitted"},
    "effects": {
        "bcid effects": "what a diagnosis can name",
        "bcid effects rough_patch": "one effect: its equation, units and look-alikes",
    },
    "bench": {
        "bcid bench": "times hot paths beside other libraries",
        "bcid bench accuracy --workspace bench --recordings logs": "models beside what an expert would take instead",
        "bcid bench parameters --fits 100": "how often the stated intervals of a car's constants hold",
    },
    "prove": {
        "bcid prove --out proof --quick": "a blind test of ten minutes",
        "bcid prove --out proof --seed 7 --minutes 60": "as much of a whole one as an hour allows",
    },
}  # fmt: skip
"""Command lines by command, with what each does."""


def examples_text(command: str) -> str:
    """The examples of a command as the end of its help: a paragraph each, as typer wants them."""
    lines = [f"{line}  —  {what}" for line, what in EXAMPLES[command].items()]
    return "\n\n".join(["Examples:", *lines])
