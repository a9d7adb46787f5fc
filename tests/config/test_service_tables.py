"""`[metrics]`, `[alerts]` and `[mqtt]`: what is refused, in one line, and secrets that others may read."""

import pytest

from bms_gateway.config import load_config, shipped
from bms_gateway.config.credential import read_secret
from bms_gateway.errors import ConfigError


@pytest.fixture
def config(tmp_path):
    """Writes the example with more at its end, and loads it."""
    (tmp_path / "string.toml").write_text(shipped("deploy/example/string.toml").read_text())
    example = shipped("deploy/example/gateway.toml").read_text()

    def load(more):
        (tmp_path / "gateway.toml").write_text(f"{example}\n{more}\n")
        return load_config(tmp_path / "gateway.toml")

    load.folder = tmp_path
    return load


def test_without_tables_metrics_are_on_loopback_and_mqtt_is_off(config):
    loaded = config("")
    assert loaded.config.metrics.address == ("127.0.0.1", 9105)
    assert loaded.config.mqtt is None
    assert (loaded.config.alerts.grace_s, loaded.config.alerts.core_max_C) == (10.0, 80.0)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ('[metrics]\nlisten = "localhost:9105"', r'metrics.listen: .*expected a numeric address and a port.*or "off"'),
        ("[metrics]\nport = 9105", r"metrics.port: unknown key; valid: listen"),
        ("[alerts]\ngrace_s = 0.0", r"alerts.grace_s: 0.0: input should be greater than or equal to 1"),
        ("[alerts]\ncore_max_C = 176.0", r"surface_max_C is 176, and no surface of 150 .* surface_max_C = 140"),
        ("[alerts]\nsurface_max_C = 150.0", r"surface_max_C is 150, and no surface of 150 .* surface_max_C = 140"),
        ("[alerts]\ncore_max_c = 60.0", r"alerts.core_max_c: unknown key; did you mean 'core_max_C'"),
        ("[mqtt]", r"mqtt.host: missing"),
        ('[mqtt]\nhost = "b"\ntopic = "a/#"', r"mqtt.topic: 'a/#': no '\+', '#' or blank"),
        ('[mqtt]\nhost = "b"\ntopic = "$SYS/x"', r"mqtt.topic: "),
        ('[mqtt]\nhost = "b"\npassword_file = "p"', r"mqtt: password_file needs username"),
        (
            '[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "p"',
            r"mqtt: password_file needs tls = true: the password",
        ),
        ('[mqtt]\nhost = "b"\nca_file = "p"', r"mqtt: ca_file and cert_file need tls = true"),
        ('[mqtt]\nhost = "b"\ntls = true\ncert_file = "p"', r"mqtt: cert_file and key_file go together"),
        ('[mqtt]\nhost = "b"\ntls = true\nusername = "u"\npassword_file = "mqtt-pasword"', r"no file .*did you mean"),
        ('[mqtt]\nhost = "b"\nspool = 5', r"mqtt.spool: 5: input should be greater"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(config, more, says):
    (config.folder / "mqtt-password").write_text("x")
    with pytest.raises(ConfigError, match=says) as told:
        config(more)
    assert "\n" not in str(told.value)


TABLE = '[mqtt]\nhost = "localhost"\nusername = "car"\npassword_file = "mqtt-password"'


@pytest.mark.parametrize("mode", [0o644, 0o604, 0o620, 0o666, 0o601])
def test_a_password_that_others_may_read_or_change_is_refused_with_the_remedy(config, mode):
    file = config.folder / "mqtt-password"
    file.write_text("word\n")
    file.chmod(mode)
    with pytest.raises(ConfigError, match=rf"mqtt.password_file: .*open to others \(mode {mode:04o}\): chmod 600 "):
        config(TABLE)
    with pytest.raises(ConfigError, match="open to others"):
        read_secret(file, "mqtt.password_file")
    file.chmod(0o600)
    assert file in config(TABLE).files
    assert read_secret(file, "x") == "word"


def test_a_credential_that_systemd_passes_on_goes_before_the_file(config, tmp_path, monkeypatch):
    file = config.folder / "mqtt-password"
    file.write_text("for root\n")
    file.chmod(0o600)
    passed = tmp_path / "credentials"
    passed.mkdir()
    (passed / "mqtt-password").write_text("for the service")
    (passed / "mqtt-password").chmod(0o440)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(passed))
    assert passed / "mqtt-password" in config(TABLE).files
    assert file not in config(TABLE).files


@pytest.mark.parametrize(("content", "says"), [(b"", "is empty"), (b"\xff\xfe", "is no text"), (b"\nx", "is empty")])
def test_a_secret_without_a_word_is_refused(tmp_path, content, says):
    file = tmp_path / "secret"
    file.write_bytes(content)
    file.chmod(0o600)
    with pytest.raises(ConfigError, match=says):
        read_secret(file, "mqtt.password_file")
