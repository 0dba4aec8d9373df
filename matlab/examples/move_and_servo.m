function move_and_servo(ros_namespace, duration)
%MOVE_AND_SERVO  Move an arm in joint space, stream to it at 200 Hz, and lift its tool.
%
%   move_and_servo('ur5')          an arm that runs as: crtk-driver ur --ns /ur5 --sim
%   move_and_servo('ur5', 2.0)     with a shorter stream than 10 s
%
%   A real arm moves by 0.1 rad in its first two joints and 5 cm up: clear the space around it.

    if nargin < 2
        duration = 10.0;
    end
    ral = crtk.ral('matlab_move_and_servo');
    cleanup = onCleanup(@() ral.shutdown());
    r = crtk_arm(ros_namespace, ral);
    ral.check_connections();

    disp('---- Enabling and homing (waiting up to 30 s each)');
    r.enable(30.0);
    r.home(30.0);

    disp('---- Joint move');
    amplitude = 0.1;
    start = r.setpoint_js();
    goal = start;
    goal(1:2) = start(1:2) + amplitude;
    r.move_jp(goal).wait();
    r.move_jp(start).wait();

    disp('---- Joint servo');
    frequency = 200;
    samples = round(duration * frequency);
    rate = ral.rate(frequency);
    for k = 0:samples
        share = 0.5 - 0.5 * cos(2.0 * pi * k / samples);
        goal(1:2) = start(1:2) + amplitude * share;
        r.servo_jp(goal);
        waitfor(rate);
    end

    disp('---- Cartesian move');
    r.hold();
    pose = r.setpoint_cp('wait', 5.0);
    pose(3, 4) = pose(3, 4) + 0.05;
    r.move_cp(pose).wait();
    measured = r.measured_cp();
    distance = norm(measured(1:3, 4) - pose(1:3, 4));
    fprintf('the tool is %.1f mm away from its goal\n', 1000.0 * distance);
    r.move_jp(start).wait();
end
