"""Errors that labnnum raises on purpose.

The tree, so that a caller knows how much to catch::

    LabnnumError
    ├── InputError (also ValueError)   what the user gave cannot be used; the command line exits with 2
    │   ├── FileError                  a file is missing, truncated, foreign or of a newer version
    │   ├── ConfigError                a key of rig.toml, model.toml or channels.toml
    │   ├── ChannelError               a channel is absent, constant, clipped, NaN, or of the wrong kind
    │   ├── UnitError                  a unit is unknown or measures something else
    │   ├── BandError                  bands overlap, are empty, or lie outside the data
    │   ├── ModelError                 a structure is singular, unstable or lacks a degree of freedom
    │   └── EstimationError            too few segments, or a setting that gives no estimate
    ├── QualityError                   data were usable but fail a threshold that the caller demanded
    ├── DriverError                    hardware
    │   ├── DeviceNotFoundError        no such port, sound card or channel
    │   ├── DeviceLostError            it was there and went away
    │   ├── ProtocolError              it answered something else than its manual says
    │   ├── DeviceTimeoutError         it did not answer in time
    │   └── SafetyError                a limit was passed and the output was switched off
    └── StoreError                     a session cannot be written: full disk, locked, closed
"""


class LabnnumError(Exception):
    """Root of every error that labnnum raises on purpose."""


class InputError(LabnnumError, ValueError):
    """What the user gave cannot be used: the message names it and says what was expected."""


class FileError(InputError):
    """A file is missing, truncated, foreign or written by a newer version."""


class ConfigError(InputError):
    """A key of a TOML file is missing, misspelt or of the wrong kind."""


class ChannelError(InputError):
    """A channel is absent, constant, clipped, holds NaN, or measures the wrong quantity."""


class UnitError(InputError):
    """A unit is unknown or measures another quantity than the channel."""


class BandError(InputError):
    """A frequency band is empty, overlaps another, or lies outside the data."""


class ModelError(InputError):
    """A structure is singular, unstable, or lacks a degree of freedom that was asked for."""


class EstimationError(InputError):
    """Too little data, or settings under which no estimate exists."""


class QualityError(LabnnumError):
    """Usable data fail a quality threshold that the caller demanded."""


class DriverError(LabnnumError):
    """A device failed."""


class DeviceNotFoundError(DriverError):
    """There is no such port, device or channel."""


class DeviceLostError(DriverError):
    """The device was there and went away."""


class ProtocolError(DriverError):
    """The device answered something other than its manual says."""


class DeviceTimeoutError(DriverError):
    """The device did not answer in time."""


class SafetyError(DriverError):
    """A limit was passed; the output has been switched off."""


class StoreError(LabnnumError):
    """A session cannot be written or read: full disk, locked by another process, closed."""
