"""The paper's claims, computed: scenes, trials over seeds, figures, verdicts."""
