"""The learned baseline: observation, action, policy file, training and Gymnasium environments."""

from typing import Final

ENVIRONMENT_ID: Final = "fastmimic/Imitation-v0"


def register() -> None:
    """Registers `ENVIRONMENT_ID` with Gymnasium, once; `import fastmimic` calls it."""
    import gymnasium

    if ENVIRONMENT_ID not in gymnasium.registry:
        gymnasium.register(
            ENVIRONMENT_ID,
            entry_point="fastmimic.learning.environment:ImitationEnv",
            vector_entry_point="fastmimic.learning.environment:ImitationVectorEnv",
        )
