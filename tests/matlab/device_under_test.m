classdef device_under_test < dynamicprops
%DEVICE_UNDER_TEST  A device with an operating state and the features that a test asks for.

    properties
        crtk_utils
    end

    methods

        function self = device_under_test(ros_namespace, ral, features)
            self.crtk_utils = crtk.utils(self, ros_namespace, ral);
            self.crtk_utils.add_operating_state();
            for k = 1:numel(features)
                self.crtk_utils.(['add_' features{k}])();
            end
        end

    end

end
