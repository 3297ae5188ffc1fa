"""From a pipeline file to artifacts: which stages there are, what each depends on, what is reused."""
