"""Other scan matchers on the same log: one adapter per library, and the run over them all."""
