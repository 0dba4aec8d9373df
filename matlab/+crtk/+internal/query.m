function value = query(device, name, varargin)
%QUERY  The answer of a kinematics service.

    value = crtk.internal.decode(crtk.internal.call(crtk.internal.with_values('solve', device, name, varargin)));
end
