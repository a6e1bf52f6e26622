"""The twin as MuJoCo model files: `hopper.xml`, and `scene.xml` with sky, light and a camera around it."""

from stepgap.robots.hopper.twin.twin import Twin

HOPPER = "hopper.xml"
SCENE = "scene.xml"


def mjcf_files(twin: Twin, boom_length: float) -> dict[str, str]:
    """Contents of the files by name. Their floor is level: unevenness belongs to a deployment, not to the model.

    Args:
        twin: Twin whose model is written.
        boom_length: Distance from pivot to hip [m]; the camera stands beyond the hip.
    """
    return {HOPPER: twin.model_xml(), SCENE: _scene(boom_length)}


def _scene(boom_length: float) -> str:
    side = f"0 {-boom_length - 1.6:g} 0.7"
    return f"""<mujoco model="stepgap_scene">
  <include file="{HOPPER}"/>
  <statistic center="0 {-boom_length:g} 0.4" extent="1.2"/>
  <visual>
    <headlight diffuse="0.6 0.6 0.6" ambient="0.3 0.3 0.3" specular="0 0 0"/>
    <rgba haze="0.75 0.82 0.9 1"/>
    <global azimuth="90" elevation="-15"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".55 .7 .9" rgb2=".95 .97 1" width="256" height="1536"/>
  </asset>
  <worldbody>
    <camera name="side" mode="targetbody" target="hopper" pos="{side}"/>
  </worldbody>
</mujoco>
"""
