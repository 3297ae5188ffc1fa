"""From a pipeline file to artifacts: the stages, what each depends on, and what is reused."""
