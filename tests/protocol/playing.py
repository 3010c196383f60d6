"""What the conversations of all instruments share."""


def played(generator, instrument, hertz, volts, offset):
    """Settings of the simulated instrument while it sounds, as the driver was told."""
    with generator:
        generator.set_frequency(hertz)
        generator.set_amplitude(volts)
        generator.set_offset(offset)
        generator.output(True)
        settings = instrument.settings
    assert settings.output
    assert not instrument.settings.output
    return settings
