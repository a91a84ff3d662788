"""The learned baseline: a policy's observation and action, its file, its training, and the environments.

Importing this package registers `fastmimic/Imitation-v0` with Gymnasium where that is installed.
"""

from fastmimic.learning.registration import register

register()
