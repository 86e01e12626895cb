"""Names that engineers give their columns: what calib takes them for, and which it leaves alone."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from calib.campaign.ingest.guesses import guessed_log_column, guessed_table_column

#: column -> names of it, separated by semicolons
TABLE: dict[str, str] = {
    "run_id": (
        "Run ; Run # ; Run No. ; run_name ; Trial ID ; Lauf-Nr. ; Versuch Nr. ; Messfahrt ; Fahrt-ID ; Nr ; "
        "No. ; Test number ; N° essai ; Essai ; Prova n. ; Prueba ; experiment ; Experiment ID ; Test run ; "
        "Run ID ; Messung Nr. ; ID ; rec ; Record ; Aufnahme"
    ),
    "session": (
        "Session ; Tag ; Day ; Date ; Datum ; Messtag ; Serie ; Block ; batch ; Series ; Campagne ; Jour ; "
        "Giorno ; Fecha ; Session no"
    ),
    "payload_kg": (
        "Payload [kg] ; Load (kg) ; Mass on board [kg] ; Zuladung ; Beladung [kg] ; Nutzlast kg ; "
        "added mass [kg] ; Extra weight (kg) ; payload mass ; Charge utile [kg] ; Carico [kg] ; Carga (kg) ; "
        "Masse additionnelle [kg] ; Ballast [kg] ; cargo_kg ; Gewicht Ladung [kg] ; Zusatzgewicht [kg] ; "
        "Zusatzmasse (kg) ; weight [kg] ; lading [kg]"
    ),
    "distance_m": (
        "Distance [m] ; S [m] ; laser distance (mm) ; Laser [mm] ; Strecke ; gemessene Strecke [mm] ; "
        "Messstrecke [mm] ; Weg Laser [m] ; travelled distance ; true distance [m] ; measured length ; "
        "Leica [mm] ; Disto [m] ; Wegstrecke [m] ; Fahrstrecke [mm] ; Fahrweg [m] ; D_laser [m] ; "
        "ground truth distance [m] ; reference distance [mm] ; Longitud [m] ; Lunghezza [mm] ; "
        "distance parcourue [m] ; Distance laser (mm) ; tape measure [mm] ; Maßband [mm] ; path length [m]"
    ),
    "counts_left": (
        "Counts left ; Encoder left ; ticks_left ; Pulse links ; Impulse links ; Enc L ; Encoder_L [counts] ; "
        "left encoder ; left counts ; Inkremente links ; Zähler links ; Codeur gauche ; Encoder sx ; "
        "Impulsi sinistra ; pulsos izquierda ; impulsions gauche ; left_ticks ; Rad links [Ink] ; Ticks L ; "
        "Left wheel ticks ; left wheel counts ; Counts (left) ; Encoderstand links ; EncL"
    ),
    "load_left_N": (
        "Load left [N] ; F_left [N] ; Radlast links [N] ; wheel load left (kg) ; Left wheel load [kg] ; "
        "Charge roue gauche [N] ; Carico ruota sx [N] ; Waage links [kg] ; scale left [kg] ; "
        "Normal force left [N] ; N_left [N] ; load on left wheel [N] ; Radaufstandskraft links [N] ; FL [N]"
    ),
    "temperature_C": (
        "Temperature ; Temp [°C] ; T [°C] ; T_floor [°C] ; Hallentemperatur [°C] ; Raumtemp. ; ambient temp ; "
        "température (°C) ; Temperatura [°C] ; T amb [°C] ; tyre temperature [°C] ; floor temp"
    ),
    "speed_mps": (
        "Speed [m/s] ; v [m/s] ; v_soll [m/s] ; Geschwindigkeit [m/s] ; set speed ; velocity [m/s] ; "
        "vitesse [m/s] ; Velocità [m/s] ; nominal speed (m/s) ; target speed [m/s] ; commanded speed [m/s] ; "
        "Sollgeschwindigkeit [m/s] ; cmd_vel [m/s] ; v_ref [m/s]"
    ),
    "direction": (
        "Direction ; Richtung ; Fahrtrichtung ; sens ; dir ; Heading of run ; driving direction ; there/back "
        "; Hin/Rück ; sense ; travel direction"
    ),
    "kind": (
        "Route ; Path ; Kind ; Type ; Manoeuvre ; trajectory ; Trajektorie ; Strecke Typ ; Streckentyp ; "
        "maneuver ; Figure ; track type ; Fahrmanöver ; course ; Shape ; pattern"
    ),
    "ref_x_m": ("x_end [m] ; End x [mm] ; X final [m] ; x ref ; ref x ; final x [mm] ; x_gt [m] ; dx [mm] ; X end"),
    "ref_theta_rad": (
        "theta_end [deg] ; End heading [°] ; yaw end [deg] ; final heading [deg] ; heading ; Endwinkel [°] ; "
        "Kurs Ende [°] ; theta_gt [rad] ; dtheta [deg]"
    ),
    "payload_x_m": (
        "payload x [m] ; x payload [mm] ; Last x [m] ; load position x [m] ; payload position x ; x_load [m] "
        "; Ladung x [mm] ; cog payload x [m]"
    ),
    "excluded": ("excluded ; ungültig ; ausgeschlossen ; invalid ; exclude ; omit ; skip ; bad"),
    "minutes_under_load": (
        "Minutes under load ; Standzeit [min] ; dwell time [min] ; dwell [min] ; waiting time [min] ; Wartezeit [min]"
    ),
}
LOG: dict[str, str] = {
    "t_s": (
        "t ; time ; Time [s] ; timestamp ; Zeit ; Zeit [ms] ; t [ms] ; stamp ; secs ; seconds ; elapsed [s] ; "
        "elapsed time ; time_stamp ; Sekunden ; ros_time ; header.stamp ; sec ; Time (sec) ; ms ; millis ; "
        "time_us ; Uhrzeit ; t_rel [s] ; rel_time"
    ),
    "counts_left": (
        "left ; enc_left ; encoder_left ; ticks_left ; left_ticks ; EncoderLeft ; leftEncoder ; encL ; enc_l "
        "; cnt_left ; qdec_l ; left_enc ; ENC_LEFT_RAW ; Drehgeber links ; Codeur G ; left_wheel_pos ; "
        "wheel_left_position ; l_enc ; lticks ; odom_left_ticks ; wheel.left.ticks ; motor_left_pos ; "
        "M1_enc left ; left pulses ; pulses_l ; left wheel encoder ; encoder.left"
    ),
    "steer_rad": (
        "steering ; steer_angle [deg] ; Lenkwinkel [°] ; steering_angle_rad ; delta [rad] ; front_angle ; "
        "sterzo [°] ; angle de braquage ; servo_pos ; steer ; wheel_angle_front"
    ),
    "counts_front": (
        "front encoder ; enc_front ; drive_encoder ; drive wheel ticks ; Encoder vorne ; traction encoder ; "
        "counts front ; Antriebsrad Impulse ; front wheel ticks"
    ),
    "ref_x_m": (
        "x ; pose_x ; mocap_x ; ref_x ; x_gt ; gt_x ; x [m] ; position.x ; pose.position.x ; TX ; px ; x_true "
        "; vicon_x [mm] ; ground_truth_x ; truth_x ; X_cam ; track_x ; rtk_x ; x_ref"
    ),
    "ref_theta_rad": (
        "theta ; yaw ; heading ; pose_yaw ; mocap_yaw ; gt_yaw ; gt_theta ; psi ; yaw_deg ; heading [°] ; rz "
        "; RZ ; yaw_gt ; theta_ref ; ground_truth_yaw ; vicon_yaw"
    ),
    "gyro_z_radps": (
        "gyro_z ; gz ; wz ; imu_gz ; angular_velocity.z ; yaw_rate ; yawrate [deg/s] ; gyro z (dps) ; omega_z "
        "; Gierrate ; imu_wz ; gyr_z"
    ),
    "range_m": (
        "laser ; range ; distance ; lidar_front ; Abstand [mm] ; Entfernung ; rangefinder [m] ; disto ; "
        "laser_distance ; tof ; Laser [mm]"
    ),
    "v_mps": ("v ; speed ; linear_velocity ; lin_vel ; twist.linear.x ; velocity ; v_x ; vx ; odom_v"),
    "omega_radps": ("omega ; w ; angular_velocity ; ang_vel ; twist.angular.z ; omega [rad/s]"),
}
#: with another order of words, unit or language
FURTHER_TABLE: dict[str, str] = {
    "run_id": ("Nr przejazdu ; Prov ; Rit"),
    "session": ("Sesja ; Shift ; Dzień"),
    "direction": ("Riktning ; Kierunek"),
    "load_left_N": ("Weight on L wheel (g) ; LH wheel [N] ; Normal force LW (kN) ; F_z left (N) ; Axle load port, N"),
    "load_right_N": ("Kraft rechts/N ; Nacisk koła prawego [N] ; Last höger (N) ; Axle load stbd, N ; F right [N]"),
    "distance_m": ("Tape distance (m) ; Travel, ft ; Afgelegde weg [mm] ; Laserstrecke/mm ; S_ref (m) ; Droga [m]"),
    "ref_x_m": ("X finale [mm]"),
}
FURTHER_LOG: dict[str, str] = {
    "t_s": ("czas [s] ; tijdstip ; tid_us ; Zeit/s"),
    "counts_left": ("hoek links ; przyrost lewy ; afstand_linkerwiel_m ; ticks_port ; meas_left_radps"),
    "speed_right_mps": ("v_RW [m/s]"),
    "counts_front": ("Drehgeber Vorderrad [Ink]"),
    "counts_rear": ("codeur_arbre"),
    "ref_x_m": ("Ost/mm ; mc_x"),
    "ref_theta_rad": ("mocap_lacet_deg ; Ref Gierwinkel [Grad]"),
}
#: no column of calib's
NO_TABLE = (
    "Operator ; Bediener ; Remark ; Comment ; Bemerkung ; Battery [V] ; Motor current left [A] ; "
    "Motor temp [°C] ; Tyre pressure [bar] ; Tire pressure left [bar] ; Humidity [%] ; Tread depth [mm] ; "
    "Wheel diameter left [mm] ; Wheel diameter [mm] ; Corridor width [m] ; Robot ; Vehicle ; AGV ; Floor "
    "; Surface ; Boden ; Weather ; Duration [s] ; Dauer [s] ; Start time ; End time ; Uhrzeit ; "
    "Total weight [kg] ; Vehicle mass [kg] ; Leergewicht [kg] ; Acceleration [m/s2] ; Max speed [m/s] ; "
    "Number of stops ; n samples ; Lateral deviation [mm] ; Offset [mm] ; Lateral error [mm] ; "
    "Height [mm] ; Radius left [mm] ; Slip left [%] ; Result ; OK ; Battery SOC [%] ; Kommentar ; "
    "Wheel set ; Reifen ; Tyre type ; Reifentyp ; Shore ; Reviewed by ; Software version ; Firmware ; "
    "Max current left ; Error code ; Status ; Typ Fahrzeug ; Laser height [mm] ; Laser type ; "
    "Laser serial no"
)
NO_LOG = (
    "battery ; battery_voltage ; current_left [A] ; torque_left [Nm] ; left_motor_current ; "
    "motor_left_temp ; pwm_left ; pwm_right ; acc_x ; accel_z [m/s^2] ; gyro_x ; gyro_y [deg/s] ; mag_x ; "
    "imu_temp ; status ; mode ; error ; quality ; n_sat ; hdop ; cpu ; loop_time [ms] ; dt ; seq ; "
    "frame_id ; index ; bumper_left ; cliff_left ; ir_left ; joy_x ; cmd_v ; cmd_w ; setpoint_left ; "
    "target_left ; v_cmd ; vx_cmd ; pitch ; roll ; z ; height ; qx ; qy ; qw ; lin_acc_x ; load_cell_left "
    "; left_current ; right_current ; fork_height [mm] ; charge_left ; line_left ; sonar_left ; "
    "us_left [cm] ; error_left ; rssi_left ; lidar_left ; obstacle_left [m] ; brake_left ; light_left ; "
    "x_cmd ; y_target ; theta_cmd ; dist_to_goal [m] ; path_error [mm] ; cross_track_error [m]"
)


@pytest.mark.parametrize(
    ("names", "others", "guessed"),
    [
        (TABLE, NO_TABLE, guessed_table_column),
        (LOG, NO_LOG, guessed_log_column),
        (FURTHER_TABLE, "Distance commanded [m] ; Sollstrecke [m] ; N_left", guessed_table_column),
        (FURTHER_LOG, "cmd_left_radps ; current_left_A", guessed_log_column),
    ],
)
def test_names_of_columns(names: dict[str, str], others: str, guessed: Callable[[str], str | None]) -> None:
    expected = {name: column for column, of in names.items() for name in of.split(" ; ")}
    assert {name: guessed(name) for name in expected} == expected
    assert [name for name in others.split(" ; ") if guessed(name)] == []
