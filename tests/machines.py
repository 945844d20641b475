"""Small machines whose dynamics are known in closed form."""

from __future__ import annotations

MASS, LENGTH = 300.0, 2.0  # of the pendulum [kg], [m]
PENDULUM = f"""<robot name="pendulum">
  <link name="post"/>
  <link name="arm"><collision><geometry><sphere radius="0.01"/></geometry></collision>
    <inertial><origin xyz="{LENGTH} 0 0"/><mass value="{MASS}"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><origin xyz="0 0 2"/><parent link="post"/><child link="arm"/>
    <axis xyz="0 -1 0"/><limit lower="-0.8" upper="0.9" velocity="1" effort="1e4"/></joint>
  <link name="end"/>
  <joint name="tool" type="fixed"><origin xyz="{LENGTH} 0 0"/><parent link="arm"/><child link="end"/></joint>
</robot>"""
