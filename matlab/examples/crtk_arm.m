classdef crtk_arm < dynamicprops
%CRTK_ARM  Any CRTK arm that can move in joint and Cartesian space, by its ROS namespace.
%   Add what you need; the fewer features, the fewer messages.

    properties (Access = protected)
        crtk_utils
    end

    methods

        function self = crtk_arm(ros_namespace, ral)
            self.crtk_utils = crtk.utils(self, ros_namespace, ral);
            self.crtk_utils.add_operating_state();
            self.crtk_utils.add_measured_js();
            self.crtk_utils.add_measured_cp();
            self.crtk_utils.add_setpoint_js();
            self.crtk_utils.add_setpoint_cp();
            self.crtk_utils.add_servo_jp();
            self.crtk_utils.add_move_jp();
            self.crtk_utils.add_move_cp();
            self.crtk_utils.add_hold();
        end

        function delete(self)
            delete(self.crtk_utils);
        end

    end

end
